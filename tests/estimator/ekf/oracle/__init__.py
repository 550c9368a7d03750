"""The processing of samples in numpy: the oracle of the native core, its Jacobians and the core's are proved by differences."""
