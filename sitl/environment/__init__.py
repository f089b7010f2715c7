"""What acts on the airframe besides its motors: air, ground, and what a weak battery leaves."""
