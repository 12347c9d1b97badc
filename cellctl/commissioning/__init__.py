"""What a technician does with a cell that runs no orders: look at its devices, jog an axis, record a bus."""
