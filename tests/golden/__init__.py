"""Golden numbers: what the code computed on the day the great rewriting began, held since.

A probe asks the public front door one small question: `vg.simulate`, `vg.plan`, `gym.make_vec`
and so on. `DATA/*.json` hold the answers, `test_golden.py` compares. What differs on purpose is
recorded again, and the commit says why:

    python -m tests.golden record NAME...   # probes or rooms; "all": everything
    python -m tests.golden check [NAME...]  # print the largest difference of each
"""
