"""Navigation units: what they send, what each message told (`seam.NavFix`), and one track out of several units (`merge`)."""
