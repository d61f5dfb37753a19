"""The agent's door: what a program that speaks the Model Context Protocol may ask of the desk."""
