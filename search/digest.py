"""One hash of an archive, by which two campaigns are shown to be the same, bit for bit."""

import hashlib

import numpy as np

from brink.search.archive import Archive


def archive_digest(archive: Archive) -> str:
    """Return the SHA-256 of an archive, as 64 hexadecimal digits.

    Hashed are, one after the other and all little-endian: the text ``brink-archive-1`` and a newline; the number
    of solutions n and of parameters d, each int64; the candidate numbers, n int64; the vectors, n x d float64 row
    by row; the verdicts, n bytes, 1 for unsafe; the fitness, n float64. Robustness and counts are left out: fitness
    follows from the counts, and robustness takes no part in the search.
    """
    rows, columns = archive.vectors.shape
    digest = hashlib.sha256(b"brink-archive-1\n")
    digest.update(np.array([rows, columns], "<i8").tobytes())
    digest.update(archive.numbers.astype("<i8").tobytes())
    digest.update(archive.vectors.astype("<f8").tobytes())
    digest.update(archive.unsafe.astype("u1").tobytes())
    digest.update(archive.fitness.astype("<f8").tobytes())
    return digest.hexdigest()
