"""The fleet filter: a Kalman filter over the states of all vehicles and the ranges between them.

Vehicles whose errors are correlated share a joint state. Measurements are applied in the order of measuring.
"""
