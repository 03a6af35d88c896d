"""What is known of APEL before any run (§3.5, §3.6): closed forms, their inverses, a model that heeds selection.

``closed_forms``, ``inverses``
    The dissertation's own: the best learner gains at every episode.
``selection_aware``, ``selection_aware_inverses``
    The same questions where only the learner that acts can gain, which is what runs show.
``chains``, ``adaptation``, ``exact``
    That model as a Markov chain: simulated, and enumerated where that is possible.
``noisy``
    The same chains with noise in the performances and a floor under acting, for which there are no closed forms.
``curves``
    The curves of Figures 3.2 to 3.4 as arrays.

Everything here is computed from the text alone and imports nothing of the selectors, so that it can test them.
"""
