"""Search: hypotheses fitted with the numbers of the model, and the evidence for each."""
