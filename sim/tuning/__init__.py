"""Gains that hold on robots and tanks that differ from the nominal ones."""
