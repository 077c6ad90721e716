"""Generative models of driving that single baselines need: a VAE and a diffusion model."""
