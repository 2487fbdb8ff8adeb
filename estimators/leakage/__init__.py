"""Leakage diagnosis on the residuals of an estimator that knows no leak."""
