"""The processing of samples in numpy: the oracle of the native core, its Jacobians proved by differences and sympy."""
