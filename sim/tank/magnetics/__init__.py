"""True fields, the swinging magnet, and what sensors make of them."""
