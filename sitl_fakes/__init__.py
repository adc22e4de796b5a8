"""Lightweight SITL fakes: the paper's aircraft as MAVLink vehicles.

They share no code with gcs_coloc and meet it on the wire only.
"""
