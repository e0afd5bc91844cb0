"""What imports share, whatever their source: a set that is written whole, and pictures of unknown origin."""
