"""Assign rows to columns at the least total cost, as scipy.optimize.linear_sum_assignment does, which takes 0.3 s of
processor time to load: more than a mission's assignments.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def cheapest_columns(cost: NDArray[np.float64]) -> NDArray[np.int64]:
    """Choose a column of its own for each row so that the costs together are least, (n_rows,).

    cost: (n_rows, n_columns), finite, with no more rows than columns. Shortest augmenting paths (D. F. Crouse, "On
    implementing 2D rectangular assignment algorithms", IEEE Trans. AES 52, 2016).
    """
    n_rows, n_columns = cost.shape
    row_of, column_of = np.full(n_columns, -1), np.full(n_rows, -1)
    of_row, of_column = np.zeros(n_rows), np.zeros(n_columns)  # prices: no cost is below the sum of its two
    for start in range(n_rows):
        shortest, before = np.full(n_columns, np.inf), np.full(n_columns, -1)
        is_open = np.ones(n_columns, dtype=np.bool_)
        on_path = [start]
        row, length = start, 0.0
        while True:
            through = length + cost[row] - of_row[row] - of_column
            nearer = is_open & (through < shortest)
            shortest[nearer], before[nearer] = through[nearer], row
            column = int(np.where(is_open, shortest, np.inf).argmin())
            length = float(shortest[column])
            is_open[column] = False
            row = int(row_of[column])
            if row < 0:
                break
            on_path.append(row)
        of_row[start] += length
        for other in on_path[1:]:
            of_row[other] += length - shortest[column_of[other]]
        closed = ~is_open
        of_column[closed] -= length - shortest[closed]
        while True:
            row = int(before[column])
            row_of[column] = row
            column_of[row], column = column, int(column_of[row])
            if row == start:
                break
    return column_of
