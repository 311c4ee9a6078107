import pytest

from offairl_lite import scale


@pytest.mark.parametrize("name", ["demo", "full"])
def test_the_variable_names_the_scale(monkeypatch, name):
    monkeypatch.setenv("OFFAIRL_SCALE", name)
    assert scale.current() == name


def test_demo_is_the_default(monkeypatch):
    monkeypatch.delenv("OFFAIRL_SCALE", raising=False)
    assert scale.current() == "demo"


@pytest.mark.parametrize("name", ["", "Demo", "paper"])
def test_another_name_is_refused_and_the_two_are_listed(monkeypatch, name):
    monkeypatch.setenv("OFFAIRL_SCALE", name)
    message = rf"OFFAIRL_SCALE is {name!r}; expected one of \('demo', 'full'\)"
    with pytest.raises(ValueError, match=message):
        scale.current()
