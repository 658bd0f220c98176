"""The car: MuJoCo model, actions, camera mount, sim-to-real differences."""
