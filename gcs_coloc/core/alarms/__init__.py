"""Alarms: what is wrong with the fleet, as people and ground tools are told of it."""
