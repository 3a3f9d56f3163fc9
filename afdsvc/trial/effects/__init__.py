"""What can be hidden: names, places, sizes and severity."""
