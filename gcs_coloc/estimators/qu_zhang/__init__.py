"""The paper's estimator (Qu and Zhang, AIAA 2010-8187): trilateration and adaptive Kalman filters."""
