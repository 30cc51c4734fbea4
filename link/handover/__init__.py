"""Control of the vehicle: who holds it, how it passes on."""
