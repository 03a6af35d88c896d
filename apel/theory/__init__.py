"""What is known of APEL before any run (§3.5, §3.6): closed forms, their inverses, a model that heeds selection."""
