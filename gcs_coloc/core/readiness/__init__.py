"""Readiness: would a healthy vehicle be located from ranges if its GPS failed now?"""
