"""Settings: errors name the key and the nearest valid one; TOML goes round."""

import pickle

import pytest

import sphfilter as sf
from sphfilter.settings import from_table


def test_paper_values():
    config = sf.FilterConfig.paper()
    scheme, test = config.scheme, config.acceptance
    published = (scheme.c_cfl, scheme.c_nns, scheme.bypass_max, scheme.buffer_ratio, scheme.represented_mass)
    assert published == (0.2, 1.0, 15, 1.5, 0.995)
    assert (scheme.support_range, scheme.cfl, scheme.integrator) == ((2.2, 3.0), "absolute", "euler")
    assert (test.z_pi, test.f_edge) == (2.576, pytest.approx(1 / 3))


def test_changes_go_to_the_part_that_has_the_key():
    config = sf.FilterConfig.paper(kernel="gaussian", z_pi=3.0)
    assert (config.scheme.kernel, config.acceptance.z_pi) == ("gaussian", 3.0)


def test_toml_goes_round():
    config = sf.FilterConfig.paper(kernel="cubic", dt_max=0.5, on_reject="resample")
    assert sf.FilterConfig.from_toml(config.to_toml()) == config


def test_settings_are_frozen_and_pickle():
    config = sf.FilterConfig()
    with pytest.raises(AttributeError):
        config.scheme = "paper"
    with pytest.raises(AttributeError):
        sf.FilterConfig.paper().scheme.kernel = "lucy"
    assert pickle.loads(pickle.dumps(config)) == config


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[scheme]\nkernl = 'lucy'", r"FilterConfig.scheme: unknown key kernl \(did you mean 'kernel'\?\)"),
        ("[schema]\n", r"unknown key FilterConfig.schema \(did you mean 'scheme'\?\)"),
        ("exact-linear = true\n", r"unknown key FilterConfig.exact-linear \(did you mean 'exact_linear'\?\)"),
        ("[scheme]\nkernel = 'lucky'", "'lucy'"),
        ("[scheme]\nc_cfl = -1", "greater than 0"),
        ("[scheme]\nc_cfl = 'fast'", "valid number"),
        ("[scheme]\nc_cfl = nan", "finite"),
        ("[scheme]\ncfl = 'relative'", "give dt_max as well"),
        ("[scheme]\nsupport_range = [3.0, 2.0]", "must rise"),
        ("[acceptance]\nf_edge = 1.0", "less than 1"),
        ("[scheme\n", "not valid TOML"),
    ],
)
def test_bad_toml(text, message):
    with pytest.raises(sf.ConfigError, match=message):
        sf.FilterConfig.from_toml(text)


def test_bad_keywords():
    with pytest.raises(sf.ConfigError, match="did you mean 'bypass_max'"):
        sf.PaperScheme(bypas_max=3)
    with pytest.raises(sf.ConfigError, match="did you mean 'kernel'"):
        sf.FilterConfig.paper(kernal="lucy")


def test_settings_from_a_table_name_the_source_and_its_keys():
    table = {"acceptance": {"z_pi": -1}, "schema": "auto"}
    with pytest.raises(sf.ConfigError) as problem:
        from_table(sf.FilterConfig, table, "mine.toml")
    said = str(problem.value)
    assert said.startswith("mine.toml: ")
    assert (
        "acceptance.z_pi = -1 is not valid" in said and "unknown key schema (did you mean 'scheme'?)" in said
    )
    assert from_table(sf.FilterConfig, {"scheme": "paper"}) == sf.FilterConfig(scheme="paper")


def test_settings_have_names():
    with pytest.raises(TypeError, match=r"by name, such as CloudScheme\(n_points="):
        sf.CloudScheme(512)
