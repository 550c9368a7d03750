"""Coverage-guided fuzzing of every parser and every path that bytes from outside take. `make fuzz`; see docs/extending.md."""
