"""Measurements: file format, checks, diagnosis, and the shipped data.

File format: `sample_columns` (names and units), `table_reader` (CSV and Parquet cells, writing),
`excel_file`, `file_options`, `data_card`. Files: `sample_file` (measured samples), `query_file`
(poses and loads to predict). Checks: `row_checks`. Diagnosis: `validation_report`, from
`anomalies` (copies, ranges, repeats), `outliers_and_drift`, `diagnosis` and `fault_hypotheses`.
Shipped data: `fanuc_r2000ic`; the user's own data: `kr10_measured`.
"""
