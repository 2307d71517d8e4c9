"""The paper's experiments, its figures beside ours, and the page that shows both."""
