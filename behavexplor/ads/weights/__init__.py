"""Policies whose file holds weights alone: a `state_dict` of torch, or safetensors."""
