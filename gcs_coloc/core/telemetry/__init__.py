"""What each vehicle says of itself, and the measurements made from it."""
