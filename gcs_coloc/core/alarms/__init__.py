"""Alarms: what is wrong with the fleet, as people are told of it.

The texts for ground tools and the traffic light of each vehicle come from them.
"""
