"""Pictures of runs and audits: PNG, self-contained HTML.

A recording (the table or the audit of a run) gives signals; these are grouped into panels of a picture, which is drawn by
matplotlib or by plotly. Both are imported where they draw, nowhere else.
"""
