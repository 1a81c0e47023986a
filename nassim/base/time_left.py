"""Estimated time left of a run: durations of its stages are kept in the cache and used in the next run."""

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from nassim.base.progress import StageEnds, track_stages
from nassim.base.storage import cache_directory, fingerprint, write_atomically


@contextmanager
def show_time_left(name: str, *settings: object) -> Iterator[None]:
    """Show the time left of the whole run in its stages, based on the last run with the same name and settings.

    The first run of its kind shows no time left. The durations of the last complete run are stored in the cache folder
    (`cache_directory`). If that folder cannot be read or written, no time is shown. A run that is interrupted does not
    change the stored durations.

    Args:
        name: name of the run, part of the file's name
        *settings: what determines the durations, as `fingerprint` takes it
    """
    path = cache_directory() / "runs" / f"{name}-{fingerprint(list(settings))[:16]}.json"
    expected: StageEnds = ()
    with suppress(OSError, ValueError, TypeError):
        expected = tuple((str(label), float(end)) for label, end in json.loads(path.read_text(encoding="utf-8")))
    with track_stages(expected) as current:
        yield
        current.end("all")
    with suppress(OSError), write_atomically(path) as temporary:
        temporary.write_text(json.dumps(current.ends), encoding="utf-8")
