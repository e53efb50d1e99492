"""FMUs for tests: `fmu/model.c`, built by the C compiler of this machine for FMI 2 or 3."""

import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Final

SOURCES: Final = Path(__file__).with_name("fmu")
VERSIONS: Final = (2, 3)
PLATFORMS: Final = {2: "linux64", 3: "x86_64-linux"}


def can_build() -> bool:
    """Return whether this machine has a C compiler."""
    return shutil.which("cc") is not None


def build(folder: Path, version: int) -> Path:
    """Return the FMU ``model2.fmu`` or ``model3.fmu`` in a folder, built for this machine."""
    library = folder / f"model{version}.so"
    subprocess.run(
        ["cc", "-shared", "-fPIC", f"-DFMI={version}", "-w", "-o", library, SOURCES / "model.c"],
        check=True,
        timeout=300,
    )
    return pack(folder / f"model{version}.fmu", library, version)


def pack(fmu: Path, library: Path, version: int, *, platform: str = "", description: str = "") -> Path:
    """Write an FMU.

    Args:
        fmu: The file to write.
        library: Its library.
        version: 2 or 3.
        platform: Platform that it claims to be built for; empty for this machine's.
        description: Its modelDescription.xml; empty for the usual one.
    """
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", description or description_of(version))
        archive.write(library, f"binaries/{platform or PLATFORMS[version]}/model.so")
    return fmu


def description_of(version: int) -> str:
    """Return the usual modelDescription.xml."""
    return (SOURCES / f"fmi{version}.xml").read_text()
