"""Many runs at once: Monte Carlo of docking and of whole assemblies."""
