"""Studies: classes that run computations, store their records, and write tables and figures.

- what all of them share: work, examples
- the paper's tables and figures: paper, counts, paths, convergence, differentiability
- published problems: benchmarks, contact_problems, solid_problems, material_problems,
  limit_problems, shakedown_problems, step42
- errors: bounds, locking, overlap
- time: cost, large, threads, accuracy, accuracy_cases, accuracy_decks
- other programs: calculix, by_getfem, getfem_program
"""
