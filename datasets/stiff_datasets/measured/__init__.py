"""Measurements: their file format, its checks, its diagnosis, and the shipped data.

The file format: `sample_columns` (names and units), `sheet_files` (CSV, Excel and Parquet cells,
and writing), `file_options`, `data_card`; and what is read: `sample_file` (measured samples),
`load_file` (poses and loads to predict), `path_file` (tool paths). Its checks: `row_checks`. Its
diagnosis: `validation_report`, from `odd_rows` (copies, ranges, repeats), `outliers_and_drift`,
`diagnosis` and `mistakes`. The shipped data: `fanuc_r2000ic`, and `kr10_measured`, the user's own.
"""
