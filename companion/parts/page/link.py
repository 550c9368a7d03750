"""The operator page for phones: this computer's address and the certificate for it, and a link as a QR code."""

import shutil
import subprocess
from contextlib import suppress
from pathlib import Path

from drivers.wires import source_towards
from estimator.contracts.errors import BadInput

_LATEST_END_S = 7 * 86_400
"""A certificate that ends within this time is made again, s."""
_LIGHT, _END = "\x1b[97;40m", "\x1b[0m"
"""White on black, whatever the terminal's own colours: not every phone reads a code of dark and light exchanged."""


def network_address(towards: str = "192.168.1.1") -> str | None:
    """Return this computer's address towards another, to which nothing is sent; None without a way."""
    with suppress(OSError):
        return source_towards((towards, 9))
    return None


def certify(address: str, certificate: Path, key: Path) -> None:
    """Make a certificate of one's own for an address, by openssl, unless there is one that holds.

    Raises:
        BadInput: openssl is missing or refuses.
    """
    if shutil.which("openssl") is None:
        raise BadInput("--page: a page beyond 127.0.0.1 needs a certificate, and openssl is missing: apt install openssl")
    holds = ["openssl", "x509", "-noout", "-checkend", str(_LATEST_END_S), "-in", str(certificate)]
    if key.exists() and subprocess.run(holds, capture_output=True, check=False).returncode == 0:
        return
    words = (
        "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 365 -subj /CN=decklander "
        f"-addext extendedKeyUsage=serverAuth -addext subjectAltName=IP:{address}"
    ).split()
    done = subprocess.run([*words, "-keyout", key, "-out", certificate], capture_output=True, text=True, check=False)
    if done.returncode:
        raise BadInput(f"--page {address}: {done.stderr.strip().splitlines()[-1]}")
    key.chmod(0o600)


def qr_code(text: str) -> str:
    """Return a QR code of a text for a terminal: two rows of modules in each line of half blocks, with the quiet zone of four."""
    import cv2
    import numpy as np

    dark = np.pad(cv2.QRCodeEncoder.create().encode(text) == 0, 2)  # the encoder leaves two modules of the quiet zone
    dark = np.pad(dark, ((0, dark.shape[0] % 2), (0, 0)))
    blocks = {(False, False): "█", (False, True): "▀", (True, False): "▄", (True, True): " "}
    rows = ("".join(blocks[bool(a), bool(b)] for a, b in zip(dark[i], dark[i + 1], strict=True)) for i in range(0, len(dark), 2))
    return "".join(f"{_LIGHT}{row}{_END}\n" for row in rows)
