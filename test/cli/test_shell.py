"""What the verbs share at the command line."""

import argparse

import pytest

from vio_eval_ros.cli.shell import Parser


def test_argparse_still_has_the_private_attribute_that_tells_numbers_from_flags():
    assert argparse.ArgumentParser()._negative_number_matcher.match('-1')


@pytest.mark.parametrize('text', ['-1', '-.5', '-1e-5', '-inf'])
def test_a_negative_number_in_any_form_is_a_value(text):
    parser = Parser('verb', 'what it does', 'examples')
    parser.add_argument('--offset', type=float)
    assert parser.parse_args(['--offset', text]).offset == float(text)
