"""What is measured: studies, their subjects, closed forms, and what the references are audited by."""
