"""Parts of adversaries that need gradients; imported when an attack begins, for torch is heavy."""
