"""What drives can do at a pose: greatest forces, torques and speeds, as polytopes."""
