"""The extended Kalman filter itself: states, process model, measurement models, gate and correction."""
