"""The folder of trials: what they are of, and their table in parts, as a sweep's is kept."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.parquet as pq

from gpuspec.detectability.bench import SCHEMA
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.keeping.writing import writes_to


class TrialsFolder(RunFolder):
    """The folder of the trials of one plan.

    ``trials.json`` says which plan; ``trials/`` holds the table, 8 parts a file. Of one station,
    trials on more parts go on with those that are there.
    """

    rows_per_file = 8
    word = "pod"
    stem = "trials"
    table_name = "trials"

    def schema(self) -> pa.Schema:
        """See :meth:`RunFolder.schema`."""
        return SCHEMA

    def repair(self) -> None:
        """See :meth:`RunFolder.repair`; the last file of a run on fewer parts is made anew."""
        with writes_to(self.path, f"the {self.word}"):
            for number in self._there():
                try:
                    rows = pq.ParquetFile(self.file(number)).metadata.num_rows
                except (pa.ArrowException, OSError):
                    continue  # damaged
                if rows != len(self.designs_of(number)):
                    self.file(number).unlink()
        super().repair()
