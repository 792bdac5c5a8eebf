"""Networks that learn from a simulated source domain first."""
