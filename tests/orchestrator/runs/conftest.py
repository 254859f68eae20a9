"""Files of suites."""

import pytest


@pytest.fixture
def suite_file(tmp_path):
    """Writes a suite, with further keys, into a new file."""

    def write(text, **more):
        path = tmp_path / f"suite-{len(list(tmp_path.iterdir()))}.yaml"
        path.write_text(text + "".join(f"{key}: {value}\n" for key, value in more.items()))
        return path

    return write
