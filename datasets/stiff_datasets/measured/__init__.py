"""Measurements: file format, checks, diagnosis, and the shipped data.

File format: `sample_columns` (names and units), `sheet_files` (CSV and Parquet cells, and writing),
`excel_file`, `file_options`, `data_card`. Files: `sample_file` (measured samples), `load_file`
(poses and loads to predict). Checks: `row_checks`. Diagnosis:
`validation_report`, from `odd_rows` (copies, ranges, repeats), `outliers_and_drift`, `diagnosis`
and `mistakes`. Shipped data: `fanuc_r2000ic`; the user's own data: `kr10_measured`.
"""
