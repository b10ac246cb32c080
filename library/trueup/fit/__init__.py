"""What we learned: parameters and residuals from adaptation episodes, and the scores of
predictors."""
