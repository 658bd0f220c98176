"""DeepRacer simulation on MuJoCo: cars, camera, tracks, reward parameters and episode rules."""
