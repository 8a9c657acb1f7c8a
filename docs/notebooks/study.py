# %% [markdown]
# # A study: variants, seeds, intervals and claims
#
# A study trains agent variants on a settings grid with several seeds, and tests claims. Finished cells are stored: a
# second call trains only new cells. [Studies](../studies.md) is the guide.

# %%
import pandas as pd
from IPython.display import SVG, Markdown

from wordcraft_kg import Study, run_study
from wordcraft_kg.studies.claims import in_words
from wordcraft_kg.studies.report import notes, study_figure, tables_of
from wordcraft_kg.studies.study import Claim
from wordcraft_kg.studies.view import view_study

pd.set_option("display.max_colwidth", None)
study = Study(
    "Does a graph help in the kitchen?",
    variants={
        "no graph": {},
        "facts": {"scorer": "facts"},
        "recipe scorer": {"scorer": "recipes", "use": "combines,component,recipe"},
    },
    scorers={"facts": {"command": "facts"}, "recipes": {"command": "train-recipes"}},
    settings={"book": "kitchen", "steps": 50_000},
    grid={"distractors": [1, 4]},
    seeds=3,
    claims=[
        Claim("A recipe scorer helps.", left="recipe scorer", right="no graph"),
        Claim(
            "The triples of the train recipes, as facts, are enough.",
            left="facts",
            right="recipe scorer",
            expected="comparable",
            by=0.02,
        ),
    ],
)
results = run_study(study, "results", name="kitchen", jobs=2)
print(f"{len(results.runs)} trainings, {len(results.missing)} missing")

# %% [markdown]
# ## Tables
#
# The summary has a table for each grid point. Seeds are independent trainings.

# %%
view = view_study(results)
tables = {
    table.title: pd.DataFrame(table.rows, columns=table.headings).set_index("variant") for table in tables_of(view)
}
pd.concat(tables, names=["tasks"])

# %%
Markdown("\n\n".join(notes(view)))

# %% [markdown]
# ## Picture

# %%
SVG(study_figure(view))

# %% [markdown]
# ## Claims
#
# Each claim gets a verdict at each grid point, by the difference's interval.

# %%
pd.DataFrame(
    [
        {
            "claim": verdict.text,
            "figures": in_words(verdict, verdict.measured[0]),
            "verdict": f"{verdict.verdict}: {verdict.why}",
        }
        for verdict in view.claims
    ]
)

# %% [markdown]
# ## More cells
#
# With another variant, the same call trains only this variant's cells.

# %%
study.variants["facts, in-sample"] = {"scorer": "facts", "in_sample": True}
more = run_study(study, "results", name="kitchen", jobs=2)
print(f"{len(more.runs)} trainings, {len(more.runs) - len(results.runs)} of them new")
