"""The whole fault matrix: the rows in lockstep, and the rows that need a process."""

from tests.support.fault_processes import PROCESS_ROWS
from tests.support.fault_rows import ROWS, Row
from tests.support.fault_rows_camera import CAMERA_ROWS, OTHER_PERSON_ROWS
from tests.support.fault_rows_image import IMAGE_ROWS
from tests.support.fault_rows_motion import MOTION_ROWS
from tests.support.fault_rows_people import AUTHORITY_ROWS, DISTANCE_ROWS
from tests.support.fault_rows_together import TOGETHER_ROWS

LOCKSTEP_ROWS: tuple[Row, ...] = (
    *ROWS,
    *AUTHORITY_ROWS,
    *DISTANCE_ROWS,
    *MOTION_ROWS,
    *IMAGE_ROWS,
    *CAMERA_ROWS,
    *OTHER_PERSON_ROWS,
    *TOGETHER_ROWS,
)
NAMES = tuple(row.name for row in (*LOCKSTEP_ROWS, *PROCESS_ROWS))
