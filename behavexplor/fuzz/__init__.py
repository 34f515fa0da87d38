"""The fuzzer: specs, behaviour, search methods."""
