"""Learn the textures of sea floor types from simulated missions."""
