"""``skyrelay doctor``: what this machine, or a vehicle, has and lacks."""
