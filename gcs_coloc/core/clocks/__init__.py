"""The clocks of vehicles and their ranging devices, mapped to the service's clock with a sigma."""
