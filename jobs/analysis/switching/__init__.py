"""How late an ensemble notices that another learner has become the better one."""
