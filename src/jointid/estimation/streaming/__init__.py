"""A record too long for memory: identified in windows, and watched for drift."""
