"""What becomes of scores: documents, tables, comparisons, curves."""
