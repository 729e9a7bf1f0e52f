"""The only code with devices and a clock: worlds to act in, and the look-plan-act loop."""
