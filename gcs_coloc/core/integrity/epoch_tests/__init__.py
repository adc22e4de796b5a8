"""Tests of single epochs: do reported positions and ranges agree, which fault explains that they do not?"""
