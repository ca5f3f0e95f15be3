"""Camera references: a robot's track in a top-view video, its errors against poses, and a cantilever's swing."""
