"""Write the seeds of every target into `fuzz/corpus`: `python -m fuzz.seeds`. Other files there are kept."""

import hashlib

from fuzz.target import CORPUS, MODULES, target


def main() -> None:
    """Write the seeds. Files are named by content, so a changed seed shows as one removed and one added."""
    for name in MODULES:
        folder = CORPUS / name
        folder.mkdir(parents=True, exist_ok=True)
        wanted = {f"seed-{hashlib.sha256(data).hexdigest()[:12]}": data for data in target(name).seeds()}
        for path in folder.glob("seed-*"):
            if path.name not in wanted:
                path.unlink()
        for file, data in wanted.items():
            (folder / file).write_bytes(data)
        print(f"{name}: {len(wanted)} seeds, {sum(map(len, wanted.values()))} bytes")


if __name__ == "__main__":
    main()
