"""Set the simulator beside physics and seas of others: `python -m benches.witness [--contact] [--body] [--seas] [--write DIR]`.

Without a name all witnesses are asked, one table each; `--write` puts the tables into evidence.md.
"""

from pathlib import Path

from benches.options import described, parsed
from benches.real import MissingDataError, write_part
from benches.witness import body, contact, seas

WITNESSES = {"--contact": contact, "--body": body, "--seas": seas}


def main() -> None:
    """Run the command."""
    parser = described(__doc__)
    for option, module in WITNESSES.items():
        parser.add_argument(option, action="append_const", dest="options", const=option, help=module.TITLE)
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every Nth row (default: all)")
    parser.add_argument("--write", type=Path, metavar="DIR", help="write the sections of evidence.md there")
    args = parsed(parser, "--contact --every 8")
    for option in args.options or WITNESSES:
        module = WITNESSES[option]
        lines = [f"## {module.TITLE}", "", f"Made by `python -m benches.witness {option} --write docs`.", ""]
        lines += [*(module.__doc__ or "").strip().splitlines()[2:], ""]
        try:
            for line in module.table(args.every):
                print(line, flush=True)
                lines.append(line)
        except ModuleNotFoundError as why:
            print(f"{module.TITLE}: {why}; install requirements/witness.txt, or the extra decklander[witness]")
            continue
        except MissingDataError as why:
            print(f"{module.TITLE}: {why}")
            continue
        if args.write is not None:
            write_part(args.write / "evidence.md", "\n".join(lines))


if __name__ == "__main__":
    main()
