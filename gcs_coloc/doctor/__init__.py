"""The doctor: checks of a fleet's set-up before a flight, each finding with its remedy.

It listens to the fleet and requests a few parameters. A finding is what would stop co-localisation.
"""
