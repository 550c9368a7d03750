"""Certificates made again for each run of the tests."""

import subprocess
from pathlib import Path


def make_certificates(folder: Path) -> dict[str, str]:
    """Make a CA, certificates of a server for localhost and 127.0.0.1, of a client, of another CA; return the server's files."""

    def openssl(*words: str) -> None:
        subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)

    def key_and_request(name: str, subject: str) -> None:
        openssl("req", "-new", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes",
                "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", subject)  # fmt: skip

    for name in ("ca", "stranger_ca"):
        openssl("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
                "-keyout", f"{name}.key", "-out", f"{name}.crt", "-subj", f"/CN={name}")  # fmt: skip
    (folder / "names.txt").write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\n")
    for name, subject in (("server", "/CN=localhost"), ("client", "/CN=drone")):
        key_and_request(name, subject)
        openssl("x509", "-req", "-in", f"{name}.csr", "-CA", "ca.crt", "-CAkey", "ca.key", "-CAcreateserial",
                "-out", f"{name}.crt", "-days", "2", "-extfile", "names.txt")  # fmt: skip
    (folder / "server.key").chmod(0o600)
    return {"certificate_file": str(folder / "server.crt"), "key_file": str(folder / "server.key")}
