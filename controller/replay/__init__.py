"""A recorded mission once more: the same controller and the same decoders, fed from the recording, in recorded time."""
