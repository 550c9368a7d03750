"""Truth generators, scenes and fakes that tests and benches share."""
