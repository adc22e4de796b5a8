"""Estimators: sans-IO plug-ins that turn timed measurements into positions with covariances."""
