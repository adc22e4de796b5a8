"""What a flight came to, as one HTML page with plots."""
