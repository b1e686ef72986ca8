"""The paper's experiments: settings → runs → results → claims and figures, each from one command."""
