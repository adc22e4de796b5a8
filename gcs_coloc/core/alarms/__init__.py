"""Alarms: what is wrong with the fleet, as people are told of it.

They have a life, texts for ground tools, and a traffic light for each vehicle.
"""
