"""The model against its peers and references: independent solvers, adversarial flights, speed."""
