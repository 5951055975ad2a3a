"""What is given: equations, sensors, where states live, simulated truths."""
