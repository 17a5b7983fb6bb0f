from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(
    **generate_distutils_setup(
        packages=["ardrone_autonomy", "ardrone_autonomy.protocol", "ardrone_autonomy.ros"],
        package_dir={"": "src"},
    )
)
