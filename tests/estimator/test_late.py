"""A late sequence is made once, when somebody reads it, and not by requesting its length."""

from estimator.late import Late


def test_it_is_made_once_and_when_it_is_read() -> None:
    made: list[int] = []

    def make() -> list[str]:
        made.append(1)
        return ["a", "b"]

    late = Late(2, make)
    assert len(late) == 2
    assert made == []
    assert (late[1], late[-2:], list(late)) == ("b", ["a", "b"], ["a", "b"])
    assert made == [1]
    assert late == ["a", "b"]
    assert late != ["a"]
