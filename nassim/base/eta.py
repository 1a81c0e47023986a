"""How long the stages of a run took the last time, kept in the cache, so that the next run can tell what is left."""

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from nassim.base.progress import Ends, course
from nassim.base.storage import cache_directory, fingerprint, written_whole


@contextmanager
def whole_run(name: str, *settings: object) -> Iterator[None]:
    """Let the stages within tell the time left of all of them, by the last run of the same name and settings.

    The first run of its kind tells nothing. What is known of the last one stands in the cache folder
    (`cache_directory`); where that cannot be read or written, nothing is told either. A run that is stopped leaves what
    is known of the last whole one.
    """
    path = cache_directory() / "runs" / f"{name}-{fingerprint(list(settings))[:16]}.json"
    expected: Ends = ()
    with suppress(OSError, ValueError, TypeError):
        expected = tuple((str(label), float(end)) for label, end in json.loads(path.read_text(encoding="utf-8")))
    with course(expected) as current:
        yield
        current.end("all")
    with suppress(OSError), written_whole(path) as temporary:
        temporary.write_text(json.dumps(current.ends), encoding="utf-8")
