"""The experiment of "Sim-to-Real Deployment and Continual Correction", World Models Handbook, which
trueup grew from."""
