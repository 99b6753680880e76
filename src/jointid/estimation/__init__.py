"""From records to answers: problems, regressions, the estimators and the verb `identify`."""
