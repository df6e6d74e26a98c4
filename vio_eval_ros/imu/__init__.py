"""How noisy an inertial sensor is, from a record of it at rest."""
