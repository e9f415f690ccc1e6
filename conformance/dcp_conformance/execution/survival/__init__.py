"""Whether the implementation still runs and answers, and which case has ended it."""
