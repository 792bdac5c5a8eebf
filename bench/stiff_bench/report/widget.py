"""The table widget that the page carries: DataTables' core, from npm, unchanged.

``python -m stiff_bench.report.widget`` fetches it again, with the ordinary npm client. To take
another version, change `VERSION` and `SHA256`; the licence beside the file comes with it.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from stiff_protocols.errors import StoreError
from stiff_protocols.files import written_whole

PACKAGE, VERSION = "datatables.net", "3.1.5"
LICENCE = "MIT"
SHA256 = "38017a5586acd9c6eb6bbfe8b6938e1a25bdc717c5acfcb07e0c9d663282c59d"
FOLDER = Path(__file__).parent / "npm"
SCRIPT = FOLDER / "dataTables.min.js"
_FILES = {"package/js/dataTables.min.js": SCRIPT, "package/License.txt": FOLDER / "LICENSE.txt"}


def widget_code() -> str:
    """Return the widget's code.

    Raises:
        StoreError: the file is not the one that was taken from npm.
    """
    return checked_code(SCRIPT.read_bytes())


def checked_code(content: bytes) -> str:
    """Return a file's content as text, if it has the hash that was recorded.

    Raises:
        StoreError: it has another one.
    """
    found = hashlib.sha256(content).hexdigest()
    if found != SHA256:
        raise StoreError(
            f"{SCRIPT}: is not {PACKAGE} {VERSION}: its sha256 is {found}, expected {SHA256}; "
            "install stiffbench again"
        )
    return content.decode()


def refresh() -> None:
    """Fetch the pinned version with npm and write its files.

    Raises:
        StoreError: what came is not what was recorded.
    """
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["npm", "pack", f"{PACKAGE}@{VERSION}"], cwd=folder, check=True)
        (archive,) = Path(folder).glob("*.tgz")
        with tarfile.open(archive) as packed:
            contents = {path: packed.extractfile(name) for name, path in _FILES.items()}
            read = {path: held.read() for path, held in contents.items() if held is not None}
    checked_code(read[SCRIPT])
    for path, content in read.items():
        with written_whole(path) as temporary:
            temporary.write_bytes(content)


if __name__ == "__main__":
    refresh()
    sys.stdout.write(f"{PACKAGE} {VERSION} is in {FOLDER}\n")
