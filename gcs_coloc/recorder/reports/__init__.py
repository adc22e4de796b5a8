"""What a replayed flight came to: scores, data-quality findings, and one HTML page with plots."""
