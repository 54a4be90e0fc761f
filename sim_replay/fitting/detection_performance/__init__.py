"""How well the payload finds mines: missions full of targets, what becomes of each look at one, and the tables fitted to that."""
