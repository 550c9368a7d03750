"""Small programs that use Decklander as a library; tests/test_examples.py runs each."""
