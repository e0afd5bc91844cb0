"""What processes that are started anew run about the child that describes shards: such a process imports it by name."""

from symsol_annot.sets.shard import reader as shards


def opens(path):
    """Open a shard, which may start the child, and return the shape of its rotations."""
    with shards.open_shard(path) as shard:
        return shard.read("rotation").shape


def pid_of(describer):
    """Return the process number of a describer's child."""
    return describer._process.pid


def put_pid(path, connection):
    """Open a shard, and send the number of this process's own child."""
    opens(path)
    connection.send(pid_of(shards._DESCRIBER))
