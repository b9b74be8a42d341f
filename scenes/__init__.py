"""What is rendered, and the words both sides share: imports neither the renderer nor the reference."""
