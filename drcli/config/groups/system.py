"""Settings of the reference's containers, windows and services; most do nothing here."""

from typing import Literal

from drcli.config.fields import Group, setting

DOCKER = "no containers are used"
WINDOW = "drcli opens no window and needs no X server"
_STREAM = "no camera stream is published"
DERIVED = "the activation script of DeepRacer-for-Cloud sets it for its containers"


class ContainerSettings(Group, title="Containers", file="system.env", ignored=DOCKER):
    simapp_source: str = setting(
        "DR_SIMAPP_SOURCE", "awsdeepracercommunity/deepracer-simapp", "Container image."
    )
    simapp_version: str = setting("DR_SIMAPP_VERSION", "6.0.4-cpu", "Version of that image.")
    minio_image: str = setting("DR_MINIO_IMAGE", "latest", "Version of MinIO.")
    analysis_image: str = setting("DR_ANALYSIS_IMAGE", "cpu", "Version of the analysis image.")
    sagemaker_image: str = setting("DR_SAGEMAKER_IMAGE", "", "Trainer image of old versions.")
    robomaker_image: str = setting("DR_ROBOMAKER_IMAGE", "", "Simulation image of old versions.")
    docker_style: Literal["swarm", "compose"] = setting(
        "DR_DOCKER_STYLE", "swarm", "How containers are started."
    )
    robomaker_mount_logs: bool = setting(
        "DR_ROBOMAKER_MOUNT_LOGS",
        False,
        "Keep simulation logs on this machine.",
        ignored="logs are always in data/logs",
    )
    robomaker_mount_simapp_dir: str = setting(
        "DR_ROBOMAKER_MOUNT_SIMAPP_DIR", "", "Simulation code to mount."
    )
    robomaker_mount_scripts_dir: str = setting(
        "DR_ROBOMAKER_MOUNT_SCRIPTS_DIR", "", "Scripts to mount.", planned=DOCKER
    )
    quiet_activate: bool = setting(
        "DR_QUIET_ACTIVATE",
        False,
        "Activate without a summary.",
        ignored="activation prints nothing",
    )


class ScreenSettings(
    Group, title="Windows, cameras and streams", file="system.env", ignored=_STREAM
):
    gui_enable: bool = setting("DR_GUI_ENABLE", False, "Show the simulator.", ignored=WINDOW)
    host_x: bool = setting("DR_HOST_X", False, "Use the X server of the host.", ignored=WINDOW)
    display: str = setting("DR_DISPLAY", "", "X display.", ignored=WINDOW)
    gazebo_args: str = setting(
        "DR_GAZEBO_ARGS", "", "Options of Gazebo.", ignored="drcli uses MuJoCo"
    )
    gazebo_render_engine: str = setting(
        "DR_GAZEBO_RENDER_ENGINE",
        "ogre2",
        "Renderer of Gazebo.",
        ignored="drcli has its own camera",
    )
    kinesis_stream_name: str = setting(
        "DR_KINESIS_STREAM_NAME", "", "Kinesis video stream.", planned=_STREAM
    )
    camera_main_enable: bool = setting(
        "DR_CAMERA_MAIN_ENABLE", True, "Camera that follows the car."
    )
    camera_sub_enable: bool = setting("DR_CAMERA_SUB_ENABLE", False, "Camera above the track.")
    camera_kvs_enable: bool = setting(
        "DR_CAMERA_KVS_ENABLE",
        True,
        "Publish the camera picture.",
        old_names=("DR_KINESIS_STREAM_ENABLE",),
    )
    enable_extra_kvs_overlay: bool = setting(
        "DR_ENABLE_EXTRA_KVS_OVERLAY", False, "More text in the picture."
    )


class ServiceSettings(Group, title="Services", file="system.env"):
    import_model_regular_upload: bool = setting(
        "DR_IMPORT_MODEL_REGULAR_UPLOAD",
        False,
        "In files of deepracer-on-the-spot.",
        ignored="its own scripts do not read it either",
        file="run.env",
    )


class DroaSettings(Group, title="DeepRacer on AWS", file="system.env"):
    droa_url: str = setting("DR_DROA_URL", "", "Address of your DeepRacer on AWS.")
    droa_username: str = setting("DR_DROA_USERNAME", "", "Your user name there.")
    droa_debug: bool = setting("DR_DROA_DEBUG", False, "Print each request, without secrets.")
    droa_aws_endpoint_url: str = setting(
        "DR_DROA_AWS_ENDPOINT_URL",
        "",
        "Another address of Cognito and S3, in a private network or a test.",
    )


class DerivedSettings(
    Group, title="Left by the reference in a shell", file="system.env", ignored=DERIVED
):
    """Variables that the reference's activation leaves in a shell."""

    reference_dir: str = setting(
        "DR_DIR",
        "",
        "Folder that holds run.env.",
        ignored="it works only as an environment variable, where it names the working folder",
    )
    reference_config: str = setting(
        "DR_CONFIG", "", "Its run.env.", ignored="scripts/activate.sh sets it"
    )
    robomaker_train_port: str = setting(
        "DR_ROBOMAKER_TRAIN_PORT", "", "Port of the training picture."
    )
    robomaker_eval_port: str = setting(
        "DR_ROBOMAKER_EVAL_PORT", "", "Port of the evaluation picture."
    )
    robomaker_gui_port: str = setting("DR_ROBOMAKER_GUI_PORT", "", "Port of the window.")
    local_s3_endpoint_url: str = setting("DR_LOCAL_S3_ENDPOINT_URL", "", "Address of the bucket.")
    minio_url: str = setting("DR_MINIO_URL", "", "Address in containers.")
    local_profile_endpoint_url: str = setting(
        "DR_LOCAL_PROFILE_ENDPOINT_URL", "", "Options of the AWS command."
    )
    local_s3_auth_mode: str = setting("DR_LOCAL_S3_AUTH_MODE", "", "Role or profile.")
    current_params_file: str = setting(
        "DR_CURRENT_PARAMS_FILE", "", "Parameter file of the container."
    )
    s3_uri: str = setting(
        "DR_S3_URI",
        "",
        "Bucket of a spot instance.",
        ignored="it has an effect only where another value contains $DR_S3_URI",
    )
