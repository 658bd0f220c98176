"""What cars perceive: cameras and lidar."""
