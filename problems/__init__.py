"""Published and flown experiments, one a file: data, model, settings and the published estimate."""
