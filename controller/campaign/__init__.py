"""The fault campaign: every fault in every state, judged by rules that were written down before."""
