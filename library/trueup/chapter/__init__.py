"""The experiment that trueup grew from: "Sim-to-Real Deployment and Continual Correction", World
Models Handbook."""
