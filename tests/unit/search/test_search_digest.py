import hashlib

import numpy as np

from brink.search.archive import Archive, Neighbourhood
from brink.search.digest import archive_digest
from brink.search.metric import Metric


def archive_of(rows: list[float], unsafe: list[bool], radius: float = 0.3) -> Archive:
    metric = Metric([1.0], [False])
    return Archive.empty(metric, Neighbourhood(radius=radius, p_th=0.1)).grown(
        np.arange(len(rows)), np.array(rows)[:, None], unsafe, np.zeros(len(rows))
    )


def test_digest_follows_the_documented_layout() -> None:
    archive = archive_of([0.25, 0.5], [True, False])
    content = b"brink-archive-1\n"
    content += (2).to_bytes(8, "little") + (1).to_bytes(8, "little")
    content += (0).to_bytes(8, "little") + (1).to_bytes(8, "little")
    content += np.array([0.25, 0.5], "<f8").tobytes() + b"\x01\x00" + archive.fitness.astype("<f8").tobytes()
    assert archive_digest(archive) == hashlib.sha256(content).hexdigest()


def test_any_difference_changes_the_digest() -> None:
    digests = {
        archive_digest(archive_of([0.25, 0.5], [True, False])),
        archive_digest(archive_of([0.25, 0.5], [False, False])),
        archive_digest(archive_of([0.25, np.nextafter(0.5, 1)], [True, False])),
        archive_digest(archive_of([0.25, 0.5], [True, False], radius=0.1)),
        archive_digest(archive_of([0.5, 0.25], [False, True])),
        archive_digest(archive_of([], [])),
    }
    assert len(digests) == 6
