"""SIGKILL at random moments: the finished set has the bytes of an undisturbed one, and nothing else is left.

python tools/soak/kills.py [--kills 30] [--seed 0]

First the set is made by 1 worker, by 2, and on a Dask cluster of 2 worker processes over TCP on loopback. Then it is
made again and again; each time, at a moment drawn uniformly from an undisturbed run's duration, somebody is killed.
A command that survives must finish by itself; else the same command is run once more.
"""

import json
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from outcomes import Outcome, run_alone
from processes import Cluster, Site, contents, differences, finished, kill, wait_for
from trials import tracebacks

SET = "--object tetX --train 800 --test 800 --size 224"
SHARDS = 16
SCHEDULER_LOST = ("is gone. Finished shards are kept", "nobody answers there")
_TRIES = 5  # at a moment that is not too late


@dataclass(frozen=True)
class Target:
    """Somebody to kill.

    Attributes:
        name: who it is.
        is_on_dask: whether the set is made on a Dask cluster.
        codes: how the command may end.
        victims: from site, cluster and a number in [0, 1) to the processes; none as long as they have not started.
    """

    name: str
    is_on_dask: bool
    codes: tuple[int, ...]
    victims: Callable


def the_command(site, cluster, chance):
    return [process for process in site.alive("command") if not process.is_blender]


def one_of(processes, chance):
    return [processes[int(chance * len(processes))]] if processes else []


def one_blender(site, cluster, chance):
    return one_of(site.blenders(), chance)


def a_worker_and_its_nanny(site, cluster, chance):
    found = cluster.workers_and_nannies()
    return found[int(chance * len(found))] if found else []


TARGETS = (
    Target("a worker", False, (0,), one_blender),
    Target("the command", False, (-signal.SIGKILL,), the_command),
    Target("the command and its workers", False, (-signal.SIGKILL,), lambda site, *_: site.alive("command")),
    Target("a Dask worker", True, (0,), lambda *who: a_worker_and_its_nanny(*who)[:1]),
    Target("a Dask worker and its nanny", True, (0,), a_worker_and_its_nanny),
    Target("a Dask worker's Blender", True, (0,), one_blender),
    Target("the Dask scheduler", True, (0, 1), lambda site, *_: site.alive("scheduler")),
    Target("the command on Dask", True, (-signal.SIGKILL,), the_command),
)


def prove(table, kills, seed):
    """Make the set undisturbed in three ways, then kill."""
    undisturbed, seconds = undisturbed_sets(table)
    for number in range(kills):
        target = TARGETS[number % len(TARGETS)]
        rng = np.random.default_rng([seed, number])
        tries = (killed(target, rng, undisturbed, seconds[target.is_on_dask]) for _ in range(_TRIES))
        table.add(next((outcome for outcome in tries if outcome), _never(target)))
    return {"set": SET, "shards": SHARDS}


def undisturbed_sets(table):
    """Return the set's bytes, and the seconds that it takes here and on Dask."""
    expected, seconds = {}, {}
    for way in ("1 worker", "2 workers", "Dask, 2 worker processes over TCP"):
        is_on_dask = way.startswith("Dask")
        with Site() as site, Cluster(site) as cluster:
            where = ("--cluster", cluster.start().address) if is_on_dask else ("--workers", way[0])
            ended = site.render(SET, *where).end()
            cluster.stop()
            outcome, expected = "the same bytes" if expected else "made", expected or contents(site.out)
            wrong = differences(site.out, expected) + site.faults() + ([] if ended.code == 0 else [ended.err])
            if len(finished(site.out / "tetX")) != SHARDS:
                wrong.append(f"expected {SHARDS} shards, found {sorted(expected)}")
        seconds[is_on_dask] = ended.seconds
        table.add(Outcome("none", way, ended.seconds, outcome, wrong))
    return expected, seconds


def killed(target, rng, undisturbed, duration):
    """Make the set with one kill, and again where the command did not survive it; None where that came too late."""
    moment, chance = rng.uniform(0, duration), rng.random()
    with Site() as site, Cluster(site) as cluster:
        if target.is_on_dask:
            cluster.start()
        run = _command(site, cluster, target)
        time.sleep(moment)
        victims = wait_for(lambda: target.victims(site, cluster, chance) or not run.is_running)
        before = finished(site.out / "tetX")
        if not run.is_running:
            return None
        kill(victims)
        at_s = run.seconds
        ended = run.end()
        wrong = _faults_of(ended, target)
        before |= finished(site.out / "tetX")
        if ended.code != 0:
            if target.name == "the Dask scheduler":
                cluster.stop()
                cluster.start()
            wrong += _resumed(_command(site, cluster, target).end(), len(before))
        wrong += [f"{name}: was made again" for name in _changed(before, finished(site.out / "tetX"))]
        wrong += [f"Blender's process {left.pid} is left" for left in site.outlasting(site.blenders)]
        cluster.stop()
        wrong += differences(site.out, undisturbed) + site.faults()
        how = "resumed" if ended.code != 0 else "finished by itself"
        where = f"at {at_s:.2f} s of {duration:.2f}"
        return Outcome(f"SIGKILL: {target.name}", where, run.seconds, f"{how}, {len(before)} shards kept", wrong)


def _command(site, cluster, target):
    where = ("--cluster", cluster.address) if target.is_on_dask else ("--workers", "2")
    return site.render(SET, *where, "--log-format", "json")


def _faults_of(ended, target):
    """Say in what a command that suffered a kill did not end as it should."""
    wrong = []
    if ended.code not in target.codes:
        wrong.append(f"ended with {ended.code}, expected one of {target.codes}: {ended.err[-500:]}")
    if ended.code == 1 and not any(words in ended.err for words in SCHEDULER_LOST):
        wrong.append(f"did not say what was lost: {ended.err[-500:]}")
    return wrong + tracebacks(ended.err)


def _resumed(ended, kept):
    """Say in what a command that goes on did not do so."""
    events = [json.loads(line) for line in ended.err.splitlines() if line.startswith("{")]
    there = [event["shards_there"] for event in events if event["event"] == "started"]
    wrong = [] if ended.code == 0 else [f"resumed, it ended with {ended.code}: {ended.err[-500:]}"]
    return wrong if there == [kept] else [*wrong, f"{kept} shards were finished; it said {there} when it went on"]


def _changed(before, after):
    return sorted(name for name, status in before.items() if after.get(name) != status)


def _never(target):
    return Outcome(f"SIGKILL: {target.name}", "", 0.0, "never in time", ["every try came after the command's end"])


if __name__ == "__main__":
    run_alone(__doc__, "kills", prove, kills=30, seed=0)
