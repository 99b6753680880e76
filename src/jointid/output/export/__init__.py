"""Exports of an identified joint; one file for each language of another tool."""
