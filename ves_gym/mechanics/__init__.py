"""Pure functions on arrays: arm, vehicle, rigid-body dynamics, motion, servo, kinematics."""
