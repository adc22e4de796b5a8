"""Lightweight SITL fakes: the paper's aircraft as MAVLink vehicles. Shares no code with gcs_coloc; they meet on the wire only."""
