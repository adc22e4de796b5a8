"""The paper's tables and figures, Monte Carlo, evaluation on data sets."""
