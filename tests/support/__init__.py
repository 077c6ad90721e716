"""What tests share: small networks and scenes, hand-written recordings, doubles, programs."""
