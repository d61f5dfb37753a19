"""From recordings to flights and drops: accuracy, speed and memory."""
