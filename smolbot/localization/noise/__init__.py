"""The sensors' noise: identified, modelled, whitened, and compared with the fit residuals."""
