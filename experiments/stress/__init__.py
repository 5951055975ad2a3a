"""Where do the filters break? Cases, hard or random, go through filters and one referee, and get a verdict.

Cases come from `hard_cases` and `random_cases`. `runs` puts them through filters (`records`), a referee
(`referees`) and related problems (`relations`), in processes of their own (`pool`), and keeps what is done
(`store`). `verdicts` judges; `tables` and `picture` show.
"""
